"""Monte-Carlo fault campaigns: scores kept inside the loop, rows on disk, statistics, thresholds for a false-alarm rate."""
