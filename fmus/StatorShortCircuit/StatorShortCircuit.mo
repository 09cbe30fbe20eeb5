model StatorShortCircuit "Current that shorted turns of the stator add to that of a healthy machine, in Park axes linked to the rotor"
  constant Real third = 2.0943951023931953 "a third of a turn, rad";
  parameter Real eta_a(unit="1", min=0, max=1, nominal=0.01) = 0 "shorted turns over turns, phase a";
  parameter Real eta_b(unit="1", min=0, max=1, nominal=0.01) = 0 "shorted turns over turns, phase b";
  parameter Real eta_c(unit="1", min=0, max=1, nominal=0.01) = 0 "shorted turns over turns, phase c";
  parameter Real Rs(unit="Ohm", min=1e-9) = 9.81 "stator resistance of one phase";
  input Real uds(unit="V") "stator voltage, direct axis";
  input Real uqs(unit="V") "stator voltage, quadrature axis";
  input Real theta(unit="rad") "electrical angle of the rotor";
  output Real ids(unit="A") "current of the short circuits, direct axis";
  output Real iqs(unit="A") "current of the short circuits, quadrature axis";
  Real ja(unit="A") "current of the short circuit along the axis of phase a";
  Real jb(unit="A") "current of the short circuit along the axis of phase b";
  Real jc(unit="A") "current of the short circuit along the axis of phase c";
equation
  ja = 2/3*eta_a/Rs*(cos(theta)*uds - sin(theta)*uqs);
  jb = 2/3*eta_b/Rs*(cos(theta - third)*uds - sin(theta - third)*uqs);
  jc = 2/3*eta_c/Rs*(cos(theta + third)*uds - sin(theta + third)*uqs);
  ids = cos(theta)*ja + cos(theta - third)*jb + cos(theta + third)*jc;
  iqs = -(sin(theta)*ja + sin(theta - third)*jb + sin(theta + third)*jc);
  annotation(experiment(StopTime=3, Interval=7e-4));
end StatorShortCircuit;
