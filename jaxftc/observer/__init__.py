"""The observer cascade, blocks 2 to 4: PI, super-twisting and Takagi-Sugeno stages on one innovation."""
