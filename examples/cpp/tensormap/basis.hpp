// A map's basis, as `GET /v1/maps/{map}/basis` answers it: how its scans become signatures.
#pragma once

#include <cmath>
#include <string>
#include <vector>

#include "json.hpp"

namespace tensormap {

// The lattice of an image: rings and azimuths of heights, or elevations and azimuths of ranges.
struct Grid {
    bool of_heights = true, wraps = true;
    int rows = 0, columns = 0;
    int azimuth_steps = 0;  // of a full turn
    double azimuth_step_deg = 1.0, ring_m = 0.0;
    double elevation_step_deg = 1.0, elevation_fraction = 0.0;
    int elevation_whole = 0;  // steps of the lowest row are this and the fraction
};

// Row after row.
struct Matrix {
    int rows = 0, columns = 0;
    std::vector<double> values;

    double operator()(int row, int column) const { return values[row * columns + column]; }
};

struct SegmentBasis {
    int segment;
    Matrix u, v;
};

struct Basis {
    std::string digest, reducer;
    bool harmonic = true, any_views = false;
    int r1 = 0, r2 = 0;
    double sensor_height_m = 0.0;
    int least_cells = 0;  // occupied ones of an image that is sent
    Grid grid;
    Matrix radial;                       // of a harmonic map
    std::vector<SegmentBasis> segments;  // of a map in the paper's encoding

    static Basis of(const Json& answer) {
        const Json& parameters = answer["parameters"];
        if (parameters.is_null()) {  // perhaps the service's reason why there is none
            const std::string& detail = answer["detail"].text;
            throw std::runtime_error("that is not a basis" + (detail.empty() ? "" : ": " + detail));
        }
        Basis basis;
        basis.digest = answer["basis"].text;
        basis.reducer = parameters["reducer"].text;
        basis.harmonic = parameters["encoding"].text == "harmonic";
        if (!basis.harmonic && parameters["encoding"].text != "paper") {
            throw std::runtime_error("the basis is of encoding " + parameters["encoding"].text);
        }
        basis.any_views = parameters["views"].text == "any";
        basis.r1 = static_cast<int>(parameters["ranks"].items.at(0).number);
        basis.r2 = static_cast<int>(parameters["ranks"].items.at(1).number);
        basis.sensor_height_m = parameters["sensor_height_m"].number;
        basis.least_cells = static_cast<int>(answer["least_cells"].number);
        basis.grid = grid_of(parameters["grid"]);
        if (basis.harmonic) basis.radial = matrix_of(answer["radial_basis"]);
        for (const Json& item : answer["segments"].items) {
            basis.segments.push_back({static_cast<int>(item["segment"].number),
                                      matrix_of(item["elevation_basis"]),
                                      matrix_of(item["azimuth_basis"])});
        }
        bool fits = !basis.harmonic || (basis.radial.rows == basis.grid.rows &&
                                        basis.radial.columns >= basis.r1 && basis.r2 > 0);
        for (const SegmentBasis& segment : basis.segments) {
            fits = fits && segment.u.rows == basis.grid.rows &&
                   segment.v.rows == basis.grid.columns;
        }
        if (!fits || basis.digest.size() < 16) throw std::runtime_error("that is not a basis");
        return basis;
    }

   private:
    static Grid grid_of(const Json& values) {
        Grid grid;
        grid.of_heights = !values["rings"].is_null();
        grid.azimuth_step_deg = values["azimuth_step_deg"].number;
        grid.azimuth_steps = static_cast<int>(std::nearbyint(360.0 / grid.azimuth_step_deg));
        grid.columns = grid.azimuth_steps;
        if (grid.of_heights) {
            grid.rows = static_cast<int>(values["rings"].number);
            grid.ring_m = values["ring_m"].number;
            return grid;
        }
        grid.rows = static_cast<int>(values["rows"].number);
        grid.wraps = values["wraps"].number != 0.0;
        grid.columns += grid.wraps ? 0 : 1;
        grid.elevation_step_deg = values["elevation_step_deg"].number;
        const double lowest = values["elevation_min_deg"].number / grid.elevation_step_deg;
        grid.elevation_whole = static_cast<int>(std::floor(lowest + 0.5));
        grid.elevation_fraction = lowest - grid.elevation_whole;
        return grid;
    }

    static Matrix matrix_of(const Json& rows) {
        Matrix matrix;
        for (const Json& row : rows.items) {
            const int columns = static_cast<int>(row.items.size());
            if (matrix.rows++ > 0 && columns != matrix.columns) {
                throw std::runtime_error("the rows of a basis differ in length");
            }
            matrix.columns = columns;
            const std::vector<double> numbers = row.numbers();
            matrix.values.insert(matrix.values.end(), numbers.begin(), numbers.end());
        }
        return matrix;
    }
};

}  // namespace tensormap
