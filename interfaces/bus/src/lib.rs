//! The only code that opens iceoryx2: names, limits, ports, wait loop.
