model PositionController "Cascade of position and speed control with a limited control voltage"
  parameter Real kp(unit="1/s") = 160.18 "gain of the position loop";
  parameter Real kv(unit="V.s/m") = 243.45 "gain of the speed loop";
  parameter Real v_max(unit="V", min=0) = 10 "limit of the control voltage";
  input Real qg(unit="m") "reference position";
  input Real q(unit="m") "position";
  input Real dq(unit="m/s") "speed";
  output Real v(unit="V") "control voltage";
equation
  v = max(-v_max, min(v_max, kv*(kp*(qg - q) - dq)));
  annotation(experiment(StopTime=25, Interval=1e-3));
end PositionController;
