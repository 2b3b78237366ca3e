"""The experiment of the paper: its conditions, what it claims, its figures and page."""
