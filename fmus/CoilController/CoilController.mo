model CoilController "PI control of the current of a coil"
  parameter Real K(unit="V/A", min=0) = 20 "gain";
  parameter Real Ti(unit="s", min=1e-9) = 0.025 "integral time";
  parameter Real integral_start(unit="V", nominal=1) = 0 "initial integral part of the voltage";
  input Real reference(unit="A") "current wanted";
  input Real i(unit="A") "current measured";
  output Real u(unit="V") "voltage";
  Real integral(unit="V", start=integral_start, fixed=true) "integral part of the voltage";
equation
  u = K*(reference - i) + integral;
  Ti*der(integral) = K*(reference - i);
  annotation(experiment(StopTime=1.2, Interval=1e-3));
end CoilController;
