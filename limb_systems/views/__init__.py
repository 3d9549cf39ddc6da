"""What people look at: plots, pages and the limb in 3D."""
