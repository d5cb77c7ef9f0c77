// Signatures of LiDAR scans for TensorMap, without dependencies. C++17; compile with -ffp-contract=off.
#pragma once

#include <algorithm>
#include <stdexcept>
#include <string>

#include "answer.hpp"
#include "basis.hpp"
#include "ground.hpp"
#include "image.hpp"
#include "json.hpp"
#include "returns.hpp"
#include "signature.hpp"

namespace tensormap {

// The ground below a scan, if the map of a basis wants scans levelled by it.
inline std::optional<Plane> plane_of_scan(const float* rows, std::size_t count, std::size_t stride,
                                          const Basis& basis, double height_m,
                                          const Gravity* gravity = nullptr) {
    if (!(height_m > 0.0 && height_m < 100.0)) {
        throw std::invalid_argument("the height of the sensor is " + std::to_string(height_m) +
                                    " m, wanted above 0 and below 100");
    }
    if (!basis.any_views) return std::nullopt;
    ground::LowestReturns lowest;
    each_block(rows, count, stride, [&](Returns& p) {
        if (gravity) level(p, *gravity);
        lowest.add(p);
    });
    return ground_plane(lowest.cells(), height_m);
}

// The image of a scan as the map of a basis wants it. Rows are read twice, in blocks that stay in the cache.
inline Image image_of_scan(const float* rows, std::size_t count, std::size_t stride,
                           const Basis& basis, double height_m, const Gravity* gravity = nullptr) {
    const auto plane = plane_of_scan(rows, count, stride, basis, height_m, gravity);
    Imager imager(basis, height_m);
    each_block(rows, count, stride, [&](Returns& p) {
        if (gravity) level(p, *gravity);
        if (plane) level(p, *plane, height_m, gravity != nullptr);
        imager.add(p);
    });
    return std::move(imager).image();
}

// The body of a query: `POST /v1/maps/{map}/localizations/signature`, with the media type
// application/vnd.tensormap.signature. Throws `Refused` if fewer cells than `least_cells` are occupied.
inline Bytes query(const float* rows, std::size_t count, std::size_t stride, const Basis& basis,
                   double height_m, const Gravity* gravity = nullptr) {
    const Image image = image_of_scan(rows, count, stride, basis, height_m, gravity);
    const auto occupied = std::count_if(image.cells.begin(), image.cells.end(),
                                        [](float metres) { return metres > 0.0f; });
    if (occupied < basis.least_cells) {
        throw Refused("too few returns: " + std::to_string(occupied) +
                      " cells of the image are occupied, the map wants at least " +
                      std::to_string(basis.least_cells));
    }
    return packed(signatures_of(image, basis), basis.digest, false);
}

}  // namespace tensormap
