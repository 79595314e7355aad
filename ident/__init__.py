"""System identification: models fitted to logs, their residuals, missing effects, reports, and experiment design."""
