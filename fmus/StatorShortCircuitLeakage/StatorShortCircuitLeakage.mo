model StatorShortCircuitLeakage "Current that shorted turns of the stator add to that of a healthy machine, in Park axes linked to the rotor"
  constant Real third = 2.0943951023931953 "a third of a turn, rad";
  parameter Real eta_a(unit="1", min=0, max=1, nominal=0.01) = 0 "shorted turns over turns, phase a";
  parameter Real eta_b(unit="1", min=0, max=1, nominal=0.01) = 0 "shorted turns over turns, phase b";
  parameter Real eta_c(unit="1", min=0, max=1, nominal=0.01) = 0 "shorted turns over turns, phase c";
  parameter Real Rs(unit="Ohm", min=1e-9) = 9.81 "stator resistance of one phase";
  parameter Real contact(unit="1", min=0) = 0.01 "resistance of the contact over that of the shorted turns";
  parameter Real lag(unit="s", min=5e-5) = 1e-3 "time constant of the shorted turns: leakage of their own over resistance";
  parameter Real ja_start(unit="A") = 0 "current of the short circuit at start, phase a";
  parameter Real jb_start(unit="A") = 0 "current of the short circuit at start, phase b";
  parameter Real jc_start(unit="A") = 0 "current of the short circuit at start, phase c";
  input Real uds(unit="V") "stator voltage, direct axis";
  input Real uqs(unit="V") "stator voltage, quadrature axis";
  input Real theta(unit="rad") "electrical angle of the rotor";
  output Real ids(unit="A") "current of the short circuits, direct axis";
  output Real iqs(unit="A") "current of the short circuits, quadrature axis";
  Real ja(unit="A", start=ja_start, fixed=true) "current of the short circuit along the axis of phase a";
  Real jb(unit="A", start=jb_start, fixed=true) "current of the short circuit along the axis of phase b";
  Real jc(unit="A", start=jc_start, fixed=true) "current of the short circuit along the axis of phase c";
equation
  lag*der(ja) + ja = 2/3*eta_a/(Rs*(1 - 2/3*eta_a + contact))*(cos(theta)*uds - sin(theta)*uqs);
  lag*der(jb) + jb = 2/3*eta_b/(Rs*(1 - 2/3*eta_b + contact))*(cos(theta - third)*uds - sin(theta - third)*uqs);
  lag*der(jc) + jc = 2/3*eta_c/(Rs*(1 - 2/3*eta_c + contact))*(cos(theta + third)*uds - sin(theta + third)*uqs);
  ids = cos(theta)*ja + cos(theta - third)*jb + cos(theta + third)*jc;
  iqs = -(sin(theta)*ja + sin(theta - third)*jb + sin(theta + third)*jc);
  annotation(experiment(StopTime=3, Interval=1e-4));
end StatorShortCircuitLeakage;
