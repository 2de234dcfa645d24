// What every kernel file says before it includes Highway.
#pragma once

// Vectors of a length unknown to the compiler cannot stand in arrays and structs, which the kernels
// need; such machines take the fixed length that they have besides (NEON on Arm).
#ifndef HWY_DISABLED_TARGETS
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE_256 | HWY_SVE2 | HWY_SVE2_128 | HWY_RVV)
#endif
