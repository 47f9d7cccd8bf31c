"""The default pose backend: a sparse tracker on one CPU core, in numpy and OpenCV."""
