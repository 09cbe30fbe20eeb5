model FaultyCoil "Coil with turns lost or gained: nominal impedance and that of the fault in series"
  parameter Real R(unit="Ohm", min=0) = 4 "resistance of the healthy coil";
  parameter Real L(unit="H", min=1e-9) = 0.1 "inductance of the healthy coil";
  parameter Real dR(unit="Ohm", nominal=1) = 0 "resistance that the fault adds, negative where turns are lost";
  parameter Real tau(unit="s", min=0) = 0.025 "time constant of the healthy coil, L/R";
  parameter Real i_start(unit="A", nominal=1) = 0 "initial current";
  input Real u(unit="V") "voltage";
  output Real i(unit="A", start=i_start, fixed=true) "current";
equation
  (L + 2*tau*dR)*der(i) = u - (R + dR)*i;
  annotation(experiment(StopTime=1, Interval=1e-3));
end FaultyCoil;
