model CurrentSensor "Sensor of a current, with the noise that it adds"
  parameter Real gain(unit="1") = 1 "gain";
  input Real i(unit="A") "current";
  input Real noise(unit="A") "noise";
  output Real measured(unit="A") "current measured";
equation
  measured = gain*i + noise;
  annotation(experiment(StopTime=1.2, Interval=1e-3));
end CurrentSensor;
