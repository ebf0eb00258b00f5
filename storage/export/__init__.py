"""Files for others: what a store holds, in the formats of other people's systems. docs/exports.md has the tables."""
