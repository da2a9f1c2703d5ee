"""How surfaces scatter light: reciprocal, and never more than arrives."""
