"""What the cascade is measured against: the field's standard methods behind the same contract."""
