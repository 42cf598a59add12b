"""The measurement models as GTSAM factors; imports numpy and gtsam, never uwgraph."""
