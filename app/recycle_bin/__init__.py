"""The recycle bin: deleted maps and drives, to be restored or removed."""
