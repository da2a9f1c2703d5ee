"""
Noise against gain
==================

A flat and a dark at each of five voltages of the microchannel plate give the gain law of a tube and
the noise that goes with it. The signal-to-noise ratio of the flats hardly changes: gain amplifies
photoelectrons, it adds none.
"""

from dataclasses import replace

import numpy as np
from matplotlib import pyplot as plt

import charact
from labdata.sensors import load_camera

whole = load_camera("gen3-digital-iccd")
camera = replace(whole, ccd=replace(whole.ccd, rows=128, columns=160))
volts = (650.0, 700.0, 750.0, 800.0, 850.0)
stacks = []
for seed, mcp_v in enumerate(volts):
    for kind, photoelectrons in (("dark", 0.0), ("flat", 3.0)):
        light = np.full((128, 160), photoelectrons)
        shot = charact.simulate(
            light,
            sensor=camera,
            photoelectrons_per_dn=1.0,
            frames=12,
            mcp_v=mcp_v,
            seed=2 * seed + (kind == "flat"),
        )
        stacks.append(
            charact.stack(shot, kind, label=f"{kind} {mcp_v:g} V", mcp_v=mcp_v, exposure_s=0.04)
        )

# %%
# Flats of one gain each have their own measurements, named by their stacks.
result = charact.noise(charact.session(stacks, sensor=camera), quick=True)
flats = [f"flat {mcp_v:g} V" for mcp_v in volts]
ratio = [result.find("snr", stack=label)[0] for label in flats]
noise = [stack.read().data.std(axis=0, ddof=1).mean() for stack in stacks[::2]]
print(f"gain exponent {result.gain_exponent.value:.2f}, 95 % {result.gain_exponent.interval95}")

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
signal = [stack.read().mean_dn - stacks[0].read().mean_dn for stack in stacks[1::2]]
left.semilogy(volts, signal, "o-", label="signal of three photoelectrons")
left.semilogy(volts, noise, "s--", label="noise of a dark frame")
left.set(xlabel="microchannel plate (V)", ylabel="DN")
left.legend()
low, middle, high = np.array([(m.interval95[0], m.value, m.interval95[1]) for m in ratio]).T
right.errorbar(volts, middle, (middle - low, high - middle), fmt="o-", capsize=3)
right.set(
    xlabel="microchannel plate (V)", ylabel="signal-to-noise ratio of a pixel (1)", ylim=(0, 3)
)
