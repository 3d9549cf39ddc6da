"""Views: plots, pages and the limb in 3D."""
