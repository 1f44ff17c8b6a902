"""Whether pictures of one view lie in one place, and how those are put back that do not."""
