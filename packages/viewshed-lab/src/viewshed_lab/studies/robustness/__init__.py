"""Which estimator withstands which attack, corruption and defense: plan, jobs, page."""
