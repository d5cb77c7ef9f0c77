// The headers for programs in C, and whatever loads shared libraries:
// c++ -std=c++17 -O2 -ffp-contract=off -shared -fPIC -o libtensormap.so c_interface.cpp
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "tensormap/tensormap.hpp"

extern "C" {

// A basis of the JSON that the service answers; null if it is not one.
void* tensormap_basis(const char* json) {
    try {
        const std::string text = json;
        return new tensormap::Basis(tensormap::Basis::of(tensormap::JsonReader(text).read()));
    } catch (const std::exception&) {
        return nullptr;
    }
}

void tensormap_free_basis(void* basis) { delete static_cast<tensormap::Basis*>(basis); }

// The body of a query in `body`, which has room for `room` bytes. Returns how many it has; -1 if there
// is no signature, and -2 if there is no room.
int tensormap_query(const void* basis, const float* rows, std::size_t count, std::size_t stride,
                    double sensor_height_m, std::uint8_t* body, std::size_t room) {
    try {
        const auto bytes = tensormap::query(
            rows, count, stride, *static_cast<const tensormap::Basis*>(basis), sensor_height_m);
        if (bytes.size() > room) return -2;
        std::memcpy(body, bytes.data(), bytes.size());
        return static_cast<int>(bytes.size());
    } catch (const std::exception&) {
        return -1;
    }
}

// The levelled returns in `levelled`, of three floats each, and their cells, -1 of those outside of the
// grid; both have room for `count`. Returns how many there are, and -1 if the height is none.
std::ptrdiff_t tensormap_cells(const void* basis, const float* rows, std::size_t count,
                               std::size_t stride, double sensor_height_m, float* levelled,
                               std::int32_t* cells) try {
    const auto& of = *static_cast<const tensormap::Basis*>(basis);
    const auto plane = tensormap::plane_of_scan(rows, count, stride, of, sensor_height_m);
    std::ptrdiff_t found = 0;
    tensormap::each_block(rows, count, stride, [&](tensormap::Returns& p) {
        if (plane) tensormap::level(p, *plane, sensor_height_m);
        tensormap::Places places;
        tensormap::put_places(p, of.grid, places);
        for (int i = 0; i < p.count; ++i, ++found) {
            const int row = places.rows[i];
            *cells++ = row < 0 ? -1 : row * of.grid.columns + places.columns[i];
            *levelled++ = p.x[i], *levelled++ = p.y[i], *levelled++ = p.z[i];
        }
    });
    return found;
} catch (const std::exception&) {
    return -1;
}
}
