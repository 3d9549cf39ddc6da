"""The wire laws, a file each."""
