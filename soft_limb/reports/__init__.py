"""Reports: plans, calibrations and runs, as text and as pages."""
