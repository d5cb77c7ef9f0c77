"""Place recognition by others, re-derived from their papers, to compare with."""
