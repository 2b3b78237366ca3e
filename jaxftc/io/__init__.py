"""Files that are whole or not there, tables, TOML, checksums, and folders that one command has for itself."""
