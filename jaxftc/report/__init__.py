"""Pages that people look at, self-contained HTML that opens offline: page and tables, figures of a run, the demo's page."""
