"""The virtual bench: instruments that answer on real wires, and the tube and camera behind them."""
