"""The walking task in numbers: body, terrain, start, references and weights."""
