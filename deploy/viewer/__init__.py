"""The live dashboard; the only importer of rerun."""
