"""Results: find, read, summarize and compare the files that soft-limb writes."""
