model InductionMachine "Induction machine in Park axes linked to the rotor, leakage summed at the stator"
  parameter Real Rs(unit="Ohm", min=0) = 9.81 "stator resistance";
  parameter Real Rr(unit="Ohm", min=0) = 3.83 "rotor resistance, referred to the stator";
  parameter Real Lm(unit="H", min=1e-9) = 0.436 "magnetising inductance";
  parameter Real Lf(unit="H", min=1e-9) = 0.0762 "leakage inductance";
  parameter Real ids_start(unit="A", nominal=1) = 0 "initial stator current, direct axis";
  parameter Real iqs_start(unit="A", nominal=1) = 0 "initial stator current, quadrature axis";
  parameter Real phidr_start(unit="Wb", nominal=1) = 0 "initial rotor flux, direct axis";
  parameter Real phiqr_start(unit="Wb", nominal=1) = 0 "initial rotor flux, quadrature axis";
  input Real uds(unit="V") "stator voltage, direct axis";
  input Real uqs(unit="V") "stator voltage, quadrature axis";
  input Real w(unit="rad/s") "electrical speed: pole pairs times mechanical speed";
  output Real ids(unit="A", start=ids_start, fixed=true) "stator current, direct axis";
  output Real iqs(unit="A", start=iqs_start, fixed=true) "stator current, quadrature axis";
  Real phidr(unit="Wb", start=phidr_start, fixed=true) "rotor flux, direct axis";
  Real phiqr(unit="Wb", start=phiqr_start, fixed=true) "rotor flux, quadrature axis";
equation
  Lf*der(ids) = uds - (Rs + Rr)*ids + w*Lf*iqs + Rr/Lm*phidr + w*phiqr;
  Lf*der(iqs) = uqs - (Rs + Rr)*iqs - w*Lf*ids + Rr/Lm*phiqr - w*phidr;
  der(phidr) = Rr*ids - Rr/Lm*phidr;
  der(phiqr) = Rr*iqs - Rr/Lm*phiqr;
  annotation(experiment(StopTime=3, Interval=7e-4));
end InductionMachine;
