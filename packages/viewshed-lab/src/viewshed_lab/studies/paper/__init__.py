"""The published study, reproduced: plan, jobs, page."""
