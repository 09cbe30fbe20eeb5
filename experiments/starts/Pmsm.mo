model Pmsm "Synchronous machine with permanent magnets, in the axes of its rotor, four pole pairs"
  parameter Real R(unit="Ohm", min=0) = 0.5 "resistance";
  parameter Real Ld(unit="H", min=1e-9) = 2e-3 "direct inductance";
  parameter Real Lq(unit="H", min=1e-9) = 4e-3 "quadrature inductance";
  parameter Real psi(unit="Wb", min=0) = 0.08 "flux of the magnets";
  parameter Real J(unit="kg.m2", min=1e-12) = 2e-3 "inertia";
  parameter Real B(unit="N.m.s/rad", min=0) = 2e-3 "viscous friction";
  parameter Real id_start(unit="A", nominal=1) = 0 "initial direct current";
  parameter Real iq_start(unit="A", nominal=1) = 0 "initial quadrature current";
  parameter Real w_start(unit="rad/s", nominal=10) = 0 "initial mechanical speed";
  input Real ud(unit="V") "direct voltage";
  input Real uq(unit="V") "quadrature voltage";
  output Real id(unit="A", nominal=1, start=id_start, fixed=true) "direct current";
  output Real iq(unit="A", nominal=1, start=iq_start, fixed=true) "quadrature current";
  output Real w(unit="rad/s", nominal=10, start=w_start, fixed=true) "mechanical speed";
equation
  Ld*der(id) = ud - R*id + 4*w*Lq*iq;
  Lq*der(iq) = uq - R*iq - 4*w*(Ld*id + psi);
  J*der(w) = 6*(psi*iq + (Ld - Lq)*id*iq) - B*w;
  annotation(experiment(StopTime=0.5, Interval=4e-4));
end Pmsm;
