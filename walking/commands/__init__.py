"""Commands on robots of several limbs, and the report of a gait."""
