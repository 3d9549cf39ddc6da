"""The commands of ``soft-limb``, by what they are about."""
