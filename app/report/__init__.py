"""The report on a drive: the paper's figures redrawn, in one file without external resources."""
