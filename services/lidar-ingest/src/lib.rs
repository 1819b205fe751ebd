//! A sensor, a log or a simulated world becomes scans.
