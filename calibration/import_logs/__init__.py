"""Logs of other programs, read as recordings; where a log does not tell, the import asks."""
