model MechanicalLoad "Shaft of a machine with a DC generator on a resistor as load"
  parameter Real J(unit="kg.m2", min=1e-9) = 0.02 "inertia of both machines";
  parameter Real f(unit="N.m.s/rad", min=0) = 0.05 "torque of the generator over the speed";
  parameter Real p(unit="1") = 2 "pole pairs";
  parameter Real period(unit="s", min=0) = 5e-5 "communication step";
  parameter Real speed_start(unit="rad/s", nominal=100) = 0 "initial mechanical speed";
  parameter Real angle_start(unit="rad", nominal=1) = 0 "initial mechanical angle";
  input Real torque(unit="N.m") "torque of the machine";
  output Real speed(unit="rad/s", start=speed_start, fixed=true) "mechanical speed";
  output Real angle(unit="rad", start=angle_start, fixed=true) "mechanical angle";
  output Real w(unit="rad/s") "electrical speed, mean over the communication step that begins";
equation
  J*der(speed) = torque - f*speed;
  der(angle) = speed;
  w = p*(speed + period/2*der(speed));
  annotation(experiment(StopTime=3, Interval=7e-4));
end MechanicalLoad;
