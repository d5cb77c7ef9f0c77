"""What is uploaded beside single scans: many in one body, and poses."""
