"""What a user would otherwise pick: MuJoCo C, MJX as it comes, a NumPy loop, other libraries."""
