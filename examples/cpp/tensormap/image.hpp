// From levelled returns to an image: heights above ground, or ranges.
#pragma once

#include <algorithm>
#include <cfloat>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "basis.hpp"
#include "returns.hpp"

namespace tensormap {

constexpr int sectors = 60;
constexpr double degrees = 57.29577951308232;  // of a radian

// Metres, row after row; columns of hidden sectors are -1. `rings` is 0 if all are within reach.
struct Image {
    int rows, columns;
    std::vector<float> cells;
    std::vector<int> hidden;
    int rings = 0;

    bool is_narrow() const { return 3 * hidden.size() >= sectors || rings > 0; }
};

// An angle in degrees to 5e-5, as of atan2(y, x) but without its branches; not nearer to 0 than 1e-30.
inline float about_angle_deg(float y, float x) {
    const float across = 0.25f * std::abs(x), aside = 0.25f * std::abs(y);  // sums are finite
    const float t = (across - aside) / (across + aside), u = t * t;
    float sum = 0.16237992f;
    sum = sum * u - 0.9170207f;
    sum = sum * u + 2.4400902f;
    sum = sum * u - 4.294574f;
    sum = sum * u + 6.0944114f;
    sum = sum * u - 8.137473f;
    sum = sum * u + 11.454849f;
    sum = sum * u - 19.09844f;
    sum = sum * u + 57.29578f;
    const float of_half_turn = 90.0f - std::copysign(45.0f + sum * t, x);
    return std::copysign(of_half_turn, y);
}

// Where the returns of a block are in an image: rows are -1 outside of the grid.
struct Places {
    int rows[block], columns[block];
};

// Angles of (x, y) in steps, from `first` on, rounded to whole ones, halves to even: as `exact(i)` does it.
// That has an arctangent, which would take most of the time of an image, and is computed only near the
// middle between two steps.
template <typename Exact>
void put_steps(const float* y, const float* x, int count, double step_deg, double first, int* whole,
               const Exact& exact) {
    constexpr float to_whole = 12582912.0f;  // 1.5 * 2^23: added and subtracted, it rounds
    const float per_deg = static_cast<float>(1.0 / step_deg), from = static_cast<float>(first);
    const float sure = static_cast<float>(0.5 - 1e-4 / step_deg);
    int unsure[block], any_unsure = 0;
    for (int i = 0; i < block; ++i) {
        const float steps = about_angle_deg(y[i], x[i]) * per_deg - from;
        const float rounded = (steps + to_whole) - to_whole;
        const bool certain =
            (std::abs(steps - rounded) < sure) & (std::abs(x[i]) + std::abs(y[i]) > 1e-30f);
        whole[i] = certain ? static_cast<int>(rounded) : 0;
        unsure[i] = !certain;
        any_unsure |= unsure[i];
    }
    for (int i = 0; any_unsure && i < count; ++i) {
        if (unsure[i]) whole[i] = exact(i);
    }
}

inline void put_azimuth_steps(const Returns& p, double step_deg, int* columns) {
    put_steps(p.y, p.x, p.count, step_deg, 0.0, columns, [&](int i) {
        const double azimuth = std::atan2(double{p.y[i]}, double{p.x[i]});
        return static_cast<int>(std::nearbyint(azimuth * degrees / step_deg));
    });
}

// Rows by horizontal distance.
inline void put_rings(const Returns& p, const Grid& grid, int* rows) {
    for (int i = 0; i < block; ++i) {
        const double x = p.x[i], y = p.y[i], ring = std::sqrt(x * x + y * y) / grid.ring_m;
        rows[i] = ring < grid.rows ? static_cast<int>(ring) : -1;
    }
}

// Rows by elevation.
inline void put_elevations(const Returns& p, const Grid& grid, int* rows) {
    double across_m[block];
    float about_m[block];
    for (int i = 0; i < block; ++i) {
        const double x = p.x[i], y = p.y[i];
        across_m[i] = std::sqrt(x * x + y * y);
        about_m[i] = static_cast<float>(across_m[i]);
    }
    const double fraction = grid.elevation_fraction;
    put_steps(p.z, about_m, p.count, grid.elevation_step_deg, fraction, rows, [&](int i) {
        const double elevation_deg = std::atan(p.z[i] / across_m[i]) * degrees;
        return static_cast<int>(std::nearbyint(elevation_deg / grid.elevation_step_deg - fraction));
    });
    for (int i = 0; i < block; ++i) {
        const int row = rows[i] - grid.elevation_whole;
        rows[i] = row >= 0 && row < grid.rows ? row : -1;
    }
}

inline void put_places(const Returns& p, const Grid& grid, Places& places) {
    put_azimuth_steps(p, grid.azimuth_step_deg, places.columns);
    const int steps = grid.azimuth_steps;
    if (grid.of_heights) {
        put_rings(p, grid, places.rows);
        for (int& column : places.columns) column += column < 0 ? steps : 0;
        return;
    }
    put_elevations(p, grid, places.rows);
    for (int& column : places.columns) {
        column += steps / 2;
        column = grid.wraps && column == steps ? 0 : column;
    }
}

constexpr double most_m = 1e30;  // that a cell may hold
constexpr float least_m = std::numeric_limits<float>::min();  // above 0, 2^-126

// Keeps one number a cell, and one of all that is outside.
class Reducer {
   public:
    Reducer(const std::string& name, int cells)
        : name_(name),
          outside_(cells),
          kept_(cells + 1, name == "nearest" ? std::numeric_limits<float>::infinity() : 0.0f) {
        if (name == "mean") sums_.resize(cells + 1), counts_.resize(cells + 1);
    }

    int outside() const { return outside_; }

    // Values, 0 or more, of a block, in the order of its returns.
    void add(const int* cells, const double* values) {
        float rounded[block];
        int any = 0, beyond = 0;
        for (int i = 0; i < block; ++i) {
            const bool inside = cells[i] != outside_;
            any |= inside;
            beyond |= inside & (values[i] > most_m);
            rounded[i] = static_cast<float>(values[i]);
        }
        any_ |= any, beyond_ |= beyond;
        float* kept = kept_.data();
        if (name_ == "mean") {
            for (int i = 0; i < block; ++i) sums_[cells[i]] += values[i], ++counts_[cells[i]];
        } else if (name_ == "last") {
            for (int i = 0; i < block; ++i) kept[cells[i]] = rounded[i];
        } else if (name_ == "nearest") {
            for (int i = 0; i < block; ++i) {
                kept[cells[i]] = std::min(kept[cells[i]], rounded[i]);
            }
        } else if (name_ == "farthest" || name_ == "highest") {
            for (int i = 0; i < block; ++i) {
                kept[cells[i]] = std::max(kept[cells[i]], rounded[i]);
            }
        } else {
            throw std::runtime_error("the reducer is " + name_);
        }
    }

    std::vector<float> cells() && {
        if (!any_) throw Refused("no return is inside the grid, wanted metres in the sensor's frame");
        if (beyond_) throw Refused("a return is beyond 1e30 m");
        kept_.pop_back();
        for (std::size_t cell = 0; cell < kept_.size(); ++cell) {
            if (!counts_.empty() && counts_[cell] > 0) {
                kept_[cell] = static_cast<float>(sums_[cell] / counts_[cell]);
            }
            // Nothing is nearest, and a subnormal number is 0.
            if (std::isinf(kept_[cell]) || kept_[cell] < least_m) kept_[cell] = 0.0f;
        }
        return std::move(kept_);
    }

   private:
    const std::string name_;
    const int outside_;
    int any_ = 0, beyond_ = 0;
    std::vector<float> kept_;
    std::vector<double> sums_;
    std::vector<int> counts_;
};

using Seen = std::vector<std::uint8_t>;  // of each column, whether it has such returns

// Which sectors see: those with returns beyond 6 m in half of their columns, of few those with any.
inline std::vector<bool> visible_sectors(const Seen& near, const Seen& far) {
    std::vector<int> wide(sectors), sees(sectors);
    std::vector<bool> reached(sectors), visible(sectors);
    const int columns = static_cast<int>(far.size());
    for (int column = 0; column < columns; ++column) {
        const int sector = column * sectors / columns;
        ++wide[sector];
        sees[sector] += far[column];
        if (near[column] || far[column]) reached[sector] = true;
    }
    for (int s = 0; s < sectors; ++s) visible[s] = 2 * sees[s] >= std::max(wide[s], 1);
    return std::count(visible.begin(), visible.end(), true) < 10 ? reached : visible;
}

// The rings within reach, 0 if all are.
inline int rings_in_reach(const Image& image) {
    int last = 0;
    for (int cell = 0; cell < image.rows * image.columns; ++cell) {
        if (image.cells[cell] > 0.0f) last = cell / image.columns;
    }
    return last >= 0.6 * image.rows || last > 15 ? 0 : std::min(std::max(last, 3), image.rows);
}

// Makes the image of a scan of its blocks, levelled if the basis is of any views.
class Imager {
   public:
    Imager(const Basis& basis, double height_m)
        : grid_(basis.grid),
          any_views_(basis.any_views),
          height_m_(height_m),
          reducer_(basis.reducer, basis.grid.rows * basis.grid.columns),
          near_(basis.grid.columns),
          far_(basis.grid.columns) {}

    void add(const Returns& p) {
        Places places;
        put_places(p, grid_, places);
        int cells[block], columns = grid_.columns, outside = reducer_.outside();
        for (int i = 0; i < block; ++i) {
            const int cell = places.rows[i] * columns + places.columns[i];
            cells[i] = places.rows[i] < 0 ? outside : cell;
        }
        std::fill(cells + p.count, cells + block, outside);
        double values[block];
        put_values(p, values);
        reducer_.add(cells, values);
        if (any_views_) see(p, places.columns);
    }

    Image image() && {
        Image image{grid_.rows, grid_.columns, std::move(reducer_).cells(), {}};
        if (any_views_) hide(image);
        const auto is_above = [](float cell) { return cell > 0.0f; };
        if (std::none_of(image.cells.begin(), image.cells.end(), is_above)) {
            throw Refused("no return is above the ground");
        }
        if (any_views_) image.rings = rings_in_reach(image);
        return image;
    }

   private:
    void put_values(const Returns& p, double* values) const {
        const double height_m = height_m_;
        if (grid_.of_heights) {
            for (int i = 0; i < block; ++i) values[i] = std::max(p.z[i] + height_m, 0.0);
            return;
        }
        for (int i = 0; i < block; ++i) {
            const double x = p.x[i], y = p.y[i], z = p.z[i], across_m = std::sqrt(x * x + y * y);
            values[i] = std::sqrt(across_m * across_m + z * z);
        }
    }

    void see(const Returns& p, const int* columns) {
        std::uint8_t* seen[] = {near_.data(), far_.data()};
        int far[block];
        for (int i = 0; i < block; ++i) {
            const double x = p.x[i], y = p.y[i];
            far[i] = x * x + y * y > 36.0;
        }
        for (int i = 0; i < p.count; ++i) seen[far[i]][columns[i]] = 1;
    }

    void hide(Image& image) const {
        const std::vector<bool> visible = visible_sectors(near_, far_);
        for (int column = 0, before = -1; column < grid_.columns; ++column) {
            const int sector = column * sectors / grid_.columns;
            if (visible[sector]) continue;
            if (sector != before) image.hidden.push_back(before = sector);
            for (int row = 0; row < grid_.rows; ++row) {
                image.cells[row * grid_.columns + column] = -1.0f;
            }
        }
    }

    const Grid grid_;
    const bool any_views_;
    const double height_m_;
    Reducer reducer_;
    Seen near_, far_;  // up to 6 m, and beyond
};

}  // namespace tensormap
