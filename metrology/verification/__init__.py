"""Verification of a rig by an artefact: errors of form, size and spacing, and deviations from certified values."""
