"""Studies on inputs that were drawn independently of the models they test."""
