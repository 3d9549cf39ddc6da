"""Pictures of walks and ways."""
