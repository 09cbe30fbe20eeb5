model SpeedController "PI control of the speed of a machine, with a limited torque and a smoothed reference"
  parameter Real K(unit="N.m.s/rad", min=0) = 0.67 "gain";
  parameter Real Ti(unit="s", min=1e-9) = 0.12 "integral time; also that in which the integral follows the limit";
  parameter Real Tr(unit="s", min=1e-9) = 0.01 "time constant of the reference, twice";
  parameter Real torque_max(unit="N.m", min=0) = 8 "limit of the torque, either way";
  parameter Real halfway_start(unit="rad/s", nominal=100) = 0 "initial reference, smoothed once";
  parameter Real smooth_start(unit="rad/s", nominal=100) = 0 "initial reference, smoothed twice";
  parameter Real integral_start(unit="N.m", nominal=1) = 0 "initial integral part of the torque";
  input Real reference(unit="rad/s") "mechanical speed wanted";
  input Real speed(unit="rad/s") "mechanical speed measured";
  output Real torque(unit="N.m") "torque wanted";
  Real halfway(unit="rad/s", start=halfway_start, fixed=true) "reference, smoothed once";
  Real smooth(unit="rad/s", start=smooth_start, fixed=true) "reference, smoothed twice";
  Real integral(unit="N.m", start=integral_start, fixed=true) "integral part of the torque";
  Real unlimited(unit="N.m") "torque without limit";
equation
  Tr*der(halfway) = reference - halfway;
  Tr*der(smooth) = halfway - smooth;
  unlimited = K*(smooth - speed) + integral;
  torque = max(-torque_max, min(torque_max, unlimited));
  Ti*der(integral) = K*(smooth - speed) + torque - unlimited;
  annotation(experiment(StopTime=3, Interval=7e-4));
end SpeedController;
