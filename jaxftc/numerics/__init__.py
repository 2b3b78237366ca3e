"""Mathematics that compiles well and has finite derivatives: smooth sign, trigonometry, barriers, batch axes."""
