"""Monte-Carlo fault campaigns: runs, rows on disk, and thresholds for a false-alarm rate."""
