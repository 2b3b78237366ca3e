"""Gaussian fuzzy inference: grades, the Takagi-Sugeno rules of the observer, and Table 1."""
