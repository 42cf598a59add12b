"""The map of the sea floor: points and mosaics from a dive's images along its solution."""
