// From an image to signatures, and their packed bytes.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <string>
#include <vector>

#include "basis.hpp"
#include "image.hpp"

namespace tensormap {

// Numbers of one scan, row after row; with a segment in the paper's encoding, where `imag` is empty.
struct Signature {
    int segment = -1;
    int r1, r2;
    std::vector<float> real, imag;
    std::vector<int> hidden;
    int rings = 0;  // 0 if all are within reach
};

using Bytes = std::vector<std::uint8_t>;

namespace packing {

inline void put(Bytes& bytes, std::uint64_t value, int count) {
    for (int i = 0; i < count; ++i) bytes.push_back(static_cast<std::uint8_t>(value >> 8 * i));
}

inline std::uint32_t bits_of(float value) {
    std::uint32_t bits;
    std::memcpy(&bits, &value, sizeof bits);
    return bits;
}

// To the nearest, halves to even; up to 65504.
inline std::uint16_t float16(double value) {
    const std::uint16_t sign = std::signbit(value) ? 0x8000 : 0;
    if (value == 0.0) return sign;
    const int exponent = std::max(std::ilogb(value), -14);
    const double steps = std::nearbyint(std::ldexp(std::abs(value), 10 - exponent));
    return static_cast<std::uint16_t>(sign | ((exponent + 14) * 1024 + static_cast<int>(steps)));
}

inline double largest_of(const std::vector<float>& numbers) {
    double largest = 0.0;
    for (const float number : numbers) largest = std::max(largest, std::abs(double{number}));
    return largest;
}

inline void put_int8(Bytes& bytes, const std::vector<float>& numbers, bool partial) {
    std::uint32_t bits = bits_of(static_cast<float>(largest_of(numbers) / 16129.0));
    if (partial) bits = (bits + 0xFFFF) & ~std::uint32_t{0xFFFF};
    put(bytes, partial ? bits >> 16 : bits, partial ? 2 : 4);
    float scale;
    std::memcpy(&scale, &bits, sizeof scale);
    for (const float n : numbers) {
        const double number = n;
        double root = 0.0;
        if (scale > 0.0f) {
            root = std::min(std::nearbyint(std::sqrt(std::abs(number) / double{scale})), 127.0);
        }
        bytes.push_back(static_cast<std::uint8_t>(
            static_cast<std::int8_t>(std::signbit(number) ? -root : root)));
    }
}

}  // namespace packing

// G = U^T S F, in as many numbers as the basis asks for of such a view.
inline Signature harmonic_signature(const Image& image, const Basis& basis) {
    int r1 = basis.r1, r2 = basis.r2;
    if (basis.any_views && image.is_narrow() && r2 > std::max(r1, 6)) {
        r1 = std::min(r1 + 2, basis.radial.columns);
        r2 -= 2;
    }
    const int columns = image.columns, rows = image.rings > 0 ? image.rings : image.rows;
    std::vector<double> cosine(columns), sine(columns);
    const double turn = 2.0 * std::acos(-1.0) / columns, norm = std::sqrt(double(columns));
    for (int k = 0; k < columns; ++k) {
        cosine[k] = std::cos(turn * k) / norm;
        sine[k] = std::sin(turn * k) / norm;
    }
    Signature found{-1, r1, r2, {}, {}, image.hidden, image.rings};
    std::vector<double> radial(columns);
    for (int r = 0; r < r1; ++r) {
        std::fill(radial.begin(), radial.end(), 0.0);
        for (int i = 0; i < rows; ++i) {
            const double u = basis.radial(i, r);
            const float* cells = &image.cells[static_cast<std::size_t>(i) * columns];
            for (int j = 0; j < columns; ++j) radial[j] += u * std::max(cells[j], 0.0f);
        }
        for (int m = 0; m < r2; ++m) {
            double real = 0.0, imag = 0.0;
            for (int j = 0, k = 0; j < columns; ++j) {
                real += radial[j] * cosine[k];
                imag -= radial[j] * sine[k];
                k += m;
                if (k >= columns) k -= columns;
            }
            found.real.push_back(static_cast<float>(real));
            found.imag.push_back(m == 0 ? 0.0f : static_cast<float>(imag));
        }
    }
    return found;
}

// G = U^T S V of one segment.
inline Signature paper_signature(const Image& image, const SegmentBasis& basis) {
    Signature found{basis.segment, basis.u.columns, basis.v.columns, {}, {}, {}};
    std::vector<double> reduced(image.columns);
    for (int r = 0; r < found.r1; ++r) {
        std::fill(reduced.begin(), reduced.end(), 0.0);
        for (int i = 0; i < image.rows; ++i) {
            for (int j = 0; j < image.columns; ++j) {
                reduced[j] += basis.u(i, r) * image.cells[i * image.columns + j];
            }
        }
        for (int m = 0; m < found.r2; ++m) {
            double sum = 0.0;
            for (int j = 0; j < image.columns; ++j) sum += reduced[j] * basis.v(j, m);
            found.real.push_back(static_cast<float>(sum));
        }
    }
    return found;
}

// A scan's one signature in a harmonic map, in the paper's encoding one of each segment.
inline std::vector<Signature> signatures_of(const Image& image, const Basis& basis) {
    if (basis.harmonic) return {harmonic_signature(image, basis)};
    std::vector<Signature> found;
    for (const SegmentBasis& segment : basis.segments) {
        found.push_back(paper_signature(image, segment));
    }
    return found;
}

// The packed bytes of a scan's signatures. Those of the paper are always float16, or float32 where
// one is beyond that.
inline Bytes packed(const std::vector<Signature>& signatures, const std::string& digest,
                    bool as_float16) {
    const Signature& first = signatures.at(0);
    const bool harmonic = first.segment < 0;
    const bool partial = first.rings > 0 || !first.hidden.empty();
    double largest = 0.0;
    for (const Signature& signature : signatures) {
        for (const auto* part : {&signature.real, &signature.imag}) {
            largest = std::max(largest, packing::largest_of(*part));
        }
    }
    const bool beyond = largest > 65504.0;
    if (harmonic && as_float16 && beyond) throw std::runtime_error("a number is beyond float16");
    int layout = beyond ? 2 : 1;
    if (harmonic) layout = as_float16 ? (partial ? 6 : 3) : (partial ? 5 : 4);
    Bytes bytes{static_cast<std::uint8_t>(layout)};
    for (int i = 0; i < 8; ++i) packing::put(bytes, std::stoul(digest.substr(2 * i, 2), nullptr, 16), 1);
    packing::put(bytes, first.r1, 1);
    packing::put(bytes, first.r2, 1);
    for (const Signature& signature : signatures) {
        std::vector<float> numbers = signature.real;
        if (harmonic) {
            numbers.clear();
            for (int r = 0; r < first.r1; ++r) numbers.push_back(signature.real[r * first.r2]);
            for (const auto* part : {&signature.real, &signature.imag}) {
                for (int at = 0; at < first.r1 * first.r2; ++at) {
                    if (at % first.r2 != 0) numbers.push_back((*part)[at]);
                }
            }
        } else {
            packing::put(bytes, signature.segment, 2);
        }
        if (partial) {
            std::uint64_t view = static_cast<std::uint64_t>(signature.rings) << sectors;
            for (const int sector : signature.hidden) view |= std::uint64_t{1} << sector;
            packing::put(bytes, view, 8);
        }
        if (layout == 4 || layout == 5) {
            packing::put_int8(bytes, numbers, partial);
        } else {
            for (const float n : numbers) {
                if (layout == 2) packing::put(bytes, packing::bits_of(n), 4);
                else packing::put(bytes, packing::float16(n), 2);
            }
        }
    }
    return bytes;
}

}  // namespace tensormap
