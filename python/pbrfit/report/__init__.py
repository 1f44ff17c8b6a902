"""Reports: a page that shows a result."""
