"""The conformance kit: scans, bases, signatures and answers (docs/reference/conformance.md)."""
