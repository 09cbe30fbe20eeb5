model PulseAdder "Adds force pulses, in volts, to the control voltage"
  input Real control(unit="V") "control voltage";
  input Real pulses(unit="V") "what is added";
  output Real v(unit="V") "voltage of the drive";
equation
  v = control + pulses;
  annotation(experiment(StopTime=25, Interval=1e-3));
end PulseAdder;
