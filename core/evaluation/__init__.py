"""Evaluation of maps and methods, by the paper's protocol and the field's."""
