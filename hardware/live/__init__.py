"""What a limb that runs tells whoever shows it."""
