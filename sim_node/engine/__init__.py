"""highway-env compiled, bit for bit: one environment for the runtime (`accelerated`), many for training (`batched`)."""
