"""Transfer functions of blurs: one class a form, its equation first, with its parameters."""
