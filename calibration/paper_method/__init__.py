"""The fits of Sec. V: stiffness, damping, heat transfer and force."""
