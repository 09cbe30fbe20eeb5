model CoilTurns "Coil with turns lost: resistance with the number of turns, inductance with its square"
  parameter Real R(unit="Ohm", min=0) = 4 "resistance of the healthy coil";
  parameter Real L(unit="H", min=1e-9) = 0.1 "inductance of the healthy coil";
  parameter Real lost(unit="1", max=0.99, nominal=0.01) = 0 "turns lost over turns, negative where turns are gained";
  parameter Real i_start(unit="A", nominal=1) = 0 "initial current";
  input Real u(unit="V") "voltage";
  output Real i(unit="A", start=i_start, fixed=true) "current";
equation
  (1 - lost)*(1 - lost)*L*der(i) = u - (1 - lost)*R*i;
  annotation(experiment(StopTime=1, Interval=1e-3));
end CoilTurns;
