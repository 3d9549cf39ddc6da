"""Reports on plans, calibrations and runs, as HTML pages."""
