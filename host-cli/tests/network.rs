//! Sessions over networks: real links of this computer with a real device behind, and simulated ones.

mod network {
    mod real;
    mod session;
    mod support;
}
