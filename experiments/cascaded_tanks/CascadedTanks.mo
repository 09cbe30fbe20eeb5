model CascadedTanks "A pump fills an upper tank, which runs into a lower one; both have a hole and a rim"
  parameter Real k(unit="1/s", min=0) = 0.052 "what a volt of the pump adds to the upper level in a second";
  parameter Real u0(unit="V", nominal=1) = 0 "voltage below which the pump delivers nothing";
  parameter Real a1(min=0) = 0.039 "outflow of the upper tank at a level of 1 V, V/s";
  parameter Real a2(min=0) = 0.046 "outflow of the lower tank at a level of 1 V, V/s";
  parameter Real p(min=0) = 0.5 "exponent of the outflow: 0.5 by Bernoulli's law, 1 for a linear one";
  parameter Real top1(unit="V") = 1000 "level of the upper rim";
  parameter Real top2(unit="V") = 1000 "level of the lower rim";
  parameter Real share(min=0, nominal=1) = 0 "of what flows over the upper rim, how much falls into the lower tank";
  parameter Real over(unit="1/s", min=0) = 0.1 "flow over a rim for a level of 1 V above it";
  parameter Real x1_start(unit="V", min=0) = 5 "initial level of the upper tank";
  parameter Real x2_start(unit="V", min=0) = 5 "initial level of the lower tank";
  input Real u(unit="V") "voltage of the pump";
  output Real y(unit="V") "level of the lower tank as its sensor shows it, at most its rim";
  output Real x1(unit="V", start=x1_start, fixed=true) "level of the upper tank";
  output Real x2(unit="V", start=x2_start, fixed=true) "level of the lower tank";
  Real q1(unit="V/s") "outflow of the upper tank";
  Real o1(unit="V/s") "flow over its rim";
equation
  q1 = a1*max(x1, 1e-9)^p;
  o1 = over*max(0, x1 - top1);
  der(x1) = k*max(0, u - u0) - q1 - o1;
  der(x2) = q1 + share*o1 - a2*max(x2, 1e-9)^p - over*max(0, x2 - top2);
  y = min(x2, top2);
  annotation(experiment(StopTime=4096, Interval=0.5));
end CascadedTanks;
