"""Evidence: verifications of rigs, and the chain that a stored value rests on."""
