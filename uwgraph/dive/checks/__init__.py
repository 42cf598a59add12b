"""The single checks behind :func:`uwgraph.dive.check.check_dive`, by what they look at."""
