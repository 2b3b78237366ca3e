"""The built-in presets: files of the format that users write, and their names."""

PRESET_NAMES = (
    "paper",
    "standard",
    "hard",
    "doubles",
    "uncommon",
    "contact",
)  # paper is the paper's four conditions in turn and has no file
