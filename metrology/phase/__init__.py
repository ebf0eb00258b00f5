"""Fused kernels: fringe frames of one camera to projector coordinate, its standard deviation, modulation and texture.

For each count the sinusoid ``I_i = A + B cos(φ + 2π(i−1)/N)`` is fitted as a phasor ``B e^{jφ}`` (paper eq 4 for
N = 4), exposures are added by inverse variance, wrapped phases are unwrapped and fused: one pass over the frames, in
chunks of a row whose intermediate values stay in the processor's first cache.

The usual scan (three counts of four steps, one exposure) has a kernel of its own that keeps everything in registers.
"""
