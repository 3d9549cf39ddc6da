"""Planning as a nonlinear program: collocation, the quasi-static start, IPOPT."""
