"""What every simulation stands on: the protocol, checks, checkpoints, and the compiled core."""
