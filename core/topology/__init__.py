"""The map as a graph: nodes where segments end and drives meet, edges along segments."""

from core.topology.graph import Entry, Topology, segment_ends

__all__ = ["Entry", "Topology", "segment_ends"]
