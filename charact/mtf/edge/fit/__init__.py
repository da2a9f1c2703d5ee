"""Forms of the point spread fitted to an edge's profile, and weighed by their evidence."""
