"""The board's program; the host shares `protocol` and the reasons in `guard`."""
