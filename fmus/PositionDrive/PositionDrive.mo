model PositionDrive "Carriage driven by a motor over a ball screw, with viscous and dry friction"
  parameter Real M(unit="kg", min=1e-9) = 95.1089 "moving mass, inertias included";
  parameter Real Fv(unit="N.s/m", min=0) = 203.5034 "viscous friction";
  parameter Real Fc(unit="N", min=0) = 20.3935 "dry friction";
  parameter Real offset(unit="N", nominal=1) = -3.1648 "constant force against the motion";
  parameter Real gtau(unit="N/V") = 35.15 "drive gain: force for a control voltage";
  parameter Real dq_eps(unit="m/s", min=1e-9) = 1e-3 "speed over which the dry friction changes sign";
  parameter Real q_start(unit="m", nominal=0.1) = 0 "initial position";
  parameter Real dq_start(unit="m/s", nominal=0.1) = 0 "initial speed";
  input Real v(unit="V") "control voltage";
  output Real q(unit="m", start=q_start, fixed=true) "position";
  output Real dq(unit="m/s", start=dq_start, fixed=true) "speed";
equation
  der(q) = dq;
  M*der(dq) = gtau*v - Fv*dq - Fc*tanh(dq/dq_eps) - offset;
  annotation(experiment(StopTime=25, Interval=2e-4));
end PositionDrive;
