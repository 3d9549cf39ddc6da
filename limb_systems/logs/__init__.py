"""Logs of other programs, read as recordings: tables of text, what their columns are, mappings."""
