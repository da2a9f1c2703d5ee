"""The bench room: what a person at the bench looks at while frames come in. It reads cameras, never moves the tube."""
