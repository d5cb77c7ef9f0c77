// Returns of a scan in blocks, and how they are rotated level by gravity.
#pragma once

#include <algorithm>
#include <cfloat>
#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <vector>

#ifdef __FAST_MATH__
#error "Signatures are specified to the operation: compile without -ffast-math."
#endif

namespace tensormap {

// There is no signature: nothing of the scan is above the ground, inside the grid or a return.
struct Refused : std::runtime_error {
    using std::runtime_error::runtime_error;
};

constexpr int block = 512;  // returns whose numbers stay in the cache

// Up to `block` returns of a scan: metres in the sensor's frame, x forward, y left, z up. Each coordinate
// is by itself, and loops without branches run to `block`, also over the finite rest behind `count`: of
// such loops every compiler makes vectors.
struct Returns {
    int count = 0;
    float x[block] = {}, y[block] = {}, z[block] = {};
};

inline bool is_return(float x, float y, float z) {
    const bool finite = (std::abs(x) <= FLT_MAX) & (std::abs(y) <= FLT_MAX) & (std::abs(z) <= FLT_MAX);
    return finite & ((x != 0.0f) | (y != 0.0f) | (z != 0.0f));
}

// Drops those that are no returns; the others stay in their order.
inline void drop_others(Returns& p) {
    for (float* axis : {p.x, p.y, p.z}) std::fill(axis + p.count, axis + block, 0.0f);
    int kept = 0;
    for (int i = 0; i < block; ++i) kept += is_return(p.x[i], p.y[i], p.z[i]);
    if (kept == p.count) return;
    kept = 0;
    for (int i = 0; i < p.count; ++i) {
        const float x = p.x[i], y = p.y[i], z = p.z[i];
        p.x[kept] = x, p.y[kept] = y, p.z[kept] = z;
        kept += is_return(x, y, z);
    }
    p.count = kept;
    for (float* axis : {p.x, p.y, p.z}) std::fill(axis + kept, axis + block, 0.0f);
}

// Gives `use` the returns of rows, `stride` floats from one to the next, block after block.
template <typename Use>
void each_block(const float* rows, std::size_t count, std::size_t stride, const Use& use) {
    Returns p;
    while (count > 0) {
        p.count = static_cast<int>(std::min<std::size_t>(block, count));
        for (int i = 0; i < p.count; ++i, rows += stride) {
            p.x[i] = rows[0], p.y[i] = rows[1], p.z[i] = rows[2];
        }
        count -= static_cast<std::size_t>(p.count);
        drop_others(p);
        use(p);
    }
}

struct Gravity {
    double roll_deg, pitch_deg;
};

// R = Ry(pitch) Rx(roll), for a vehicle that measures gravity.
inline void level(Returns& p, const Gravity& gravity) {
    const double to_rad = std::acos(-1.0) / 180.0;
    const double cr = std::cos(gravity.roll_deg * to_rad), sr = std::sin(gravity.roll_deg * to_rad);
    const double cp = std::cos(gravity.pitch_deg * to_rad), sp = std::sin(gravity.pitch_deg * to_rad);
    for (int i = 0; i < block; ++i) {
        const double x = p.x[i], y = p.y[i], z = p.z[i];
        p.x[i] = static_cast<float>(cp * x + sp * sr * y + sp * cr * z);
        p.y[i] = static_cast<float>(cr * y - sr * z);
        p.z[i] = static_cast<float>(-sp * x + cp * sr * y + cp * cr * z);
    }
    drop_others(p);
}

}  // namespace tensormap
