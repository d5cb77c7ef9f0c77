"""Whether a match can be trusted: calibrated probabilities, and the decision they lead to."""
