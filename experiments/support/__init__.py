"""What the experiments share; not an experiment itself."""
