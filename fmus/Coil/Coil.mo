model Coil "Coil: a resistance and an inductance in series"
  parameter Real R(unit="Ohm", min=0) = 4 "resistance";
  parameter Real L(unit="H", min=1e-9) = 0.1 "inductance";
  parameter Real i_start(unit="A", nominal=1) = 0 "initial current";
  input Real u(unit="V") "voltage";
  output Real i(unit="A", start=i_start, fixed=true) "current";
equation
  L*der(i) = u - R*i;
  annotation(experiment(StopTime=1, Interval=1e-3));
end Coil;
