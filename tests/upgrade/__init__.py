"""Data directories of earlier versions."""
