"""The map as a graph: nodes where segments end and drives meet, edges along segments."""

from core.topology.graph import JOINED, Entry, Topology, segment_ends
from core.topology.joining import cut_at_meetings, join_segments

__all__ = ["JOINED", "Entry", "Topology", "cut_at_meetings", "join_segments", "segment_ends"]
