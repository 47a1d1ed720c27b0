"""Export: a run's policy as a file that other programs run without pecjax."""
