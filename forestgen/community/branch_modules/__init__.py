"""The parts of the model of branch modules."""
