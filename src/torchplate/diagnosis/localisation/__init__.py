"""Where the misfit sits: in frequency, in the channels, on the plate, and of which kind it is.

- `localise`: all of it together; `sentences`: in words.
- `misfit`: what a model leaves, in standard deviations of its noise; `channels`: what it leaves of each FRF.
- `force`: the force at one place that would explain it; `reach`: from there to all channels.
- `factor`: the gain, delay or single channel that would.
"""
