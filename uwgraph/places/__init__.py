"""Places: recognised by a learned metric, verified by geometry, kept in a topological map."""
