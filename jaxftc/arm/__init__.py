"""The arm: its numbers, any serial arm of hinges, and two engines behind one door."""
