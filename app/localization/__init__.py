"""Localization: where am I, by a scan, an image or a signature."""
