"""What results are, what made them, and how they differ: ``show`` and ``compare``."""
