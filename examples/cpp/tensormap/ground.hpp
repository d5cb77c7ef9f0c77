// The ground below a sensor, a plane through the lowest returns: docs/reference/signature.md, levelling.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <tuple>
#include <vector>

#include "returns.hpp"

namespace tensormap {

// z = a * x + b * y + offset, in the sensor's frame.
struct Plane {
    double a, b, offset;

    double above(double x, double y, double z) const { return z - (a * x + b * y + offset); }
    double length() const { return std::sqrt(1.0 + a * a + b * b); }
    double depth() const { return -offset * (1.0 / length()); }
};

namespace ground {

struct Cell {
    double x, y, z;
};
using Cells = std::vector<Cell>;

constexpr int half_side = 12, side = 2 * half_side;
constexpr std::size_t least_cells = 20;
constexpr double tolerance_m = 0.15;

// floor(x / 2), counted from the first cell.
inline int cell_of(float x) {
    const int whole = static_cast<int>(x);  // towards 0
    return (whole - (x < static_cast<float>(whole)) + 2 * half_side) / 2;
}

// The lowest return of each cell of 2 m, without the vehicle's own cells and those too far away.
class LowestReturns {
   public:
    void add(const Returns& p) {
        constexpr float reach_m = 2.0f * half_side;
        int cells[block];
        for (int i = 0; i < block; ++i) {
            const float x = p.x[i], y = p.y[i];
            const int near = (x >= -reach_m) & (x < reach_m) & (y >= -reach_m) & (y < reach_m);
            const float of = static_cast<float>(near);  // the others to the vehicle's own cells
            cells[i] = cell_of(of * x) * side + cell_of(of * y);
        }
        for (int i = 0; i < p.count; ++i) {
            Lowest& low = lowest_[cells[i]];
            if (p.z[i] > low.z) continue;
            if (p.z[i] < low.z || std::tie(p.x[i], p.y[i]) < std::tie(low.x, low.y)) {
                low = {p.x[i], p.y[i], p.z[i]};
            }
        }
    }

    Cells cells() const {
        Cells cells;
        for (int row = 0; row < side; ++row) {
            for (int column = 0; column < side; ++column) {
                const int x = 2 * (row - half_side) + 1, y = 2 * (column - half_side) + 1;
                const Lowest& low = lowest_[row * side + column];
                const bool own = std::abs(x) < 2 && std::abs(y) < 2;
                if (own || x * x + y * y >= side * side || std::isinf(low.z)) continue;
                cells.push_back({low.x, low.y, low.z});
            }
        }
        return cells;
    }

   private:
    struct Lowest {
        float x, y, z;
    };

    std::vector<Lowest> lowest_ = std::vector<Lowest>(side * side, Lowest{0.0f, 0.0f, INFINITY});
};

struct Slope {
    int i, j, steep;
};

inline std::vector<Slope> candidates() {
    std::vector<Slope> slopes;
    for (int i = -10; i <= 10; ++i) {
        for (int j = -10; j <= 10; ++j) {
            if (i * i + j * j <= 100) slopes.push_back({i, j, i * i + j * j});
        }
    }
    std::stable_sort(slopes.begin(), slopes.end(),
                     [](const Slope& one, const Slope& other) { return one.steep < other.steep; });
    return slopes;
}

// The candidate and window with the highest score.
inline Plane consensus(const Cells& cells, double shallowest_m, double deepest_m) {
    const int bins = std::max(static_cast<int>(std::ceil((deepest_m - shallowest_m) * 20.0)), 4);
    const double last = bins;
    // How many cells are below all bins, in each bin, and above. In two halves, since neighbours are often
    // in the same bin and would wait for each other.
    std::vector<int> counts(bins + 2), others(bins + 2);
    std::vector<int> in_bin(cells.size() + cells.size() % 2);  // the one too many is below
    std::vector<int> up_to(bins + 1);  // how many cells are in the bins before
    Plane best{};
    int highest = std::numeric_limits<int>::min();
    for (const Slope& slope : candidates()) {
        const double a = slope.i / 50.0, b = slope.j / 50.0;
        for (std::size_t i = 0; i < cells.size(); ++i) {
            double at = (cells[i].z - (a * cells[i].x + b * cells[i].y) + deepest_m) * 20.0;
            at = at < 0.0 ? -1.0 : at;
            at = at < last ? at : last;
            in_bin[i] = static_cast<int>(at) + 1;
        }
        std::fill(counts.begin(), counts.end(), 0);
        std::fill(others.begin(), others.end(), 0);
        for (std::size_t i = 0; i < in_bin.size(); i += 2) ++counts[in_bin[i]], ++others[in_bin[i + 1]];
        for (int bin = 0; bin < bins; ++bin) {
            up_to[bin + 1] = up_to[bin] + counts[bin + 1] + others[bin + 1];
        }
        for (int k = 0; k + 4 <= bins; ++k) {
            const int within = up_to[k + 4] - up_to[k];
            const int under = up_to[std::max(k - 1, 0)] - up_to[std::max(k - 10, 0)];
            const int score = 4 * within - 6 * under - slope.steep;
            if (score > highest) {
                highest = score;
                best = {a, b, (k + 2.0) / 20.0 - deepest_m};
            }
        }
    }
    return best;
}

inline Cells near_to(const Plane& plane, const Cells& cells, double within_m) {
    Cells near;
    for (const Cell& cell : cells) {
        if (std::abs(plane.above(cell.x, cell.y, cell.z)) <= within_m) near.push_back(cell);
    }
    return near;
}

// Moves the cells' mean to the origin and returns it. Sums are added one by one.
inline Cell centre(Cells& cells) {
    Cell sum{0.0, 0.0, 0.0};
    for (const Cell& cell : cells) sum = {sum.x + cell.x, sum.y + cell.y, sum.z + cell.z};
    const double count = static_cast<double>(cells.size());
    const Cell mean{sum.x / count, sum.y / count, sum.z / count};
    for (Cell& cell : cells) cell = {cell.x - mean.x, cell.y - mean.y, cell.z - mean.z};
    return mean;
}

inline Plane least_squares(Cells cells) {
    const Cell mean = centre(cells);
    double xx = 0.0, xy = 0.0, yy = 0.0, xz = 0.0, yz = 0.0;
    for (const Cell& c : cells) {
        xx += c.x * c.x;
        xy += c.x * c.y;
        yy += c.y * c.y;
        xz += c.x * c.z;
        yz += c.y * c.z;
    }
    xx += 50.0;
    yy += 50.0;
    const double determinant = xx * yy - xy * xy;
    const double a = (yy * xz - xy * yz) / determinant, b = (xx * yz - xy * xz) / determinant;
    return {a, b, mean.z - (a * mean.x + b * mean.y)};
}

// The standard deviation of cells along the direction in which it is least.
inline double narrow_side_m(Cells cells) {
    centre(cells);
    double xx = 0.0, xy = 0.0, yy = 0.0;
    for (const Cell& c : cells) {
        xx += c.x * c.x;
        xy += c.x * c.y;
        yy += c.y * c.y;
    }
    const double half = (xx + yy) / 2.0, apart = (xx - yy) / 2.0;
    const double least = std::max(half - std::sqrt(apart * apart + xy * xy), 0.0);
    return std::sqrt(least / static_cast<double>(cells.size()));
}

// Whether enough of the ground is seen to trust a plane.
inline bool is_supported(const Plane& plane, const Cells& cells, double height_m,
                         double shallowest_m, double deepest_m) {
    const Cells near = near_to(plane, cells, tolerance_m);
    const double depth_m = plane.depth();
    if (near.size() < least_cells || !(shallowest_m <= depth_m && depth_m <= deepest_m) ||
        plane.a * plane.a + plane.b * plane.b > 0.22 * 0.22 || narrow_side_m(near) < 2.0) {
        return false;
    }
    double squares = 0.0;
    for (const Cell& cell : near) {
        const double above = plane.above(cell.x, cell.y, cell.z);
        squares += above * above;
    }
    const auto is_under = [&](const Cell& cell) {
        return plane.above(cell.x, cell.y, cell.z) < -tolerance_m;
    };
    const double all = static_cast<double>(cells.size()), count = static_cast<double>(near.size());
    const double under = static_cast<double>(std::count_if(cells.begin(), cells.end(), is_under));
    const double higher = (height_m - depth_m) / height_m, rough_m = std::sqrt(squares / count);
    const double least_share = 0.15 + 2.5 * std::max(0.0, higher - 0.05) +
                               10.0 * std::max(0.0, rough_m - 0.05) + under / all;
    return count / all >= least_share;
}

}  // namespace ground

// The ground around a sensor of that height, none where too little of it is seen.
inline std::optional<Plane> ground_plane(const ground::Cells& cells, double height_m) {
    if (cells.size() < ground::least_cells) return std::nullopt;
    const double shallowest_m = std::max(0.4 * height_m, height_m - 1.5);
    const double deepest_m = std::min(2.2 * height_m, height_m + 1.5);
    Plane plane = ground::consensus(cells, shallowest_m, deepest_m);
    for (const double within_m : {0.3, 0.2, 0.15, 0.15}) {
        const ground::Cells near = ground::near_to(plane, cells, within_m);
        if (near.size() < ground::least_cells) return std::nullopt;
        plane = ground::least_squares(near);
    }
    if (!ground::is_supported(plane, cells, height_m, shallowest_m, deepest_m)) return std::nullopt;
    return plane;
}

// Makes returns those of a level sensor of that height above this plane: rotated and moved, or only
// moved where its axes are level by gravity.
inline void level(Returns& p, const Plane& plane, double height_m, bool by_gravity = false) {
    const double length = plane.length();
    const double nx = -plane.a / length, ny = -plane.b / length, nz = 1.0 / length;
    const double across = 1.0 + nz, up_m = plane.depth() - height_m;
    const double lift_m = -plane.offset - height_m;
    const double xx = 1.0 - nx * nx / across, xy = -(nx * ny) / across, yy = 1.0 - ny * ny / across;
    for (int i = 0; i < block; ++i) {
        const double x = p.x[i], y = p.y[i], z = p.z[i];
        if (by_gravity) {
            p.z[i] = static_cast<float>(z + lift_m);
        } else {
            p.x[i] = static_cast<float>(xx * x + xy * y - nx * z);
            p.y[i] = static_cast<float>(xy * x + yy * y - ny * z);
            p.z[i] = static_cast<float>(nx * x + ny * y + nz * z + up_m);
        }
    }
    drop_others(p);
}

}  // namespace tensormap
