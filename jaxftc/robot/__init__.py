"""The arm: its numbers, any serial arm of hinges, rigid-body dynamics, and two engines behind one signature."""
