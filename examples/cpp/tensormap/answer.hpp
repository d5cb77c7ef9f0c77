// A packed answer of 60 bytes: docs/reference/http-api.md.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <stdexcept>

namespace tensormap {

// What is not known is NaN.
struct Answer {
    enum class Reason {
        none,
        unknown_place,
        ambiguous,
        too_few_returns,
        outside_prior,
        not_calibrated
    };

    bool localized, of_live, estimated;
    Reason reason;
    unsigned segment, drive;
    std::uint32_t scan_index;
    std::array<std::uint8_t, 8> revision;
    double probability, distance, ratio, z_m, yaw_deg;
    double along_std_m, lateral_std_m, heading_std_deg, x_m, y_m;

    static constexpr std::size_t bytes = 60;

    static Answer of(const std::uint8_t* at, std::size_t size) {
        if (size < bytes) throw std::runtime_error("the answer has less than 60 bytes");
        if (at[0] != 1) throw std::runtime_error("the answer's layout is not 1");
        Answer found{};
        found.localized = at[1] & 1;
        found.of_live = at[1] & 2;
        found.estimated = at[1] & 4;
        found.reason = static_cast<Reason>(at[1] >> 4);
        found.segment = static_cast<unsigned>(whole(at + 2, 2));
        found.drive = static_cast<unsigned>(whole(at + 4, 2));
        found.scan_index = static_cast<std::uint32_t>(whole(at + 6, 4));
        std::memcpy(found.revision.data(), at + 10, 8);
        double* singles[] = {&found.probability, &found.distance, &found.ratio, &found.z_m,
                             &found.yaw_deg};
        for (int i = 0; i < 5; ++i) {
            const auto bits = static_cast<std::uint32_t>(whole(at + 18 + 4 * i, 4));
            float value;
            std::memcpy(&value, &bits, sizeof value);
            *singles[i] = value;
        }
        double* halves[] = {&found.along_std_m, &found.lateral_std_m, &found.heading_std_deg};
        for (int i = 0; i < 3; ++i) *halves[i] = half(whole(at + 38 + 2 * i, 2));
        double* doubles[] = {&found.x_m, &found.y_m};
        for (int i = 0; i < 2; ++i) {
            const std::uint64_t bits = whole(at + 44 + 8 * i, 8);
            std::memcpy(doubles[i], &bits, sizeof bits);
        }
        return found;
    }

   private:
    static std::uint64_t whole(const std::uint8_t* at, int count) {
        std::uint64_t value = 0;
        for (int i = count; i-- > 0;) value = value << 8 | at[i];
        return value;
    }

    static double half(std::uint64_t bits) {
        const int exponent = static_cast<int>(bits >> 10 & 31), steps = static_cast<int>(bits & 1023);
        double value = std::ldexp(exponent > 0 ? 1024 + steps : steps, std::max(exponent, 1) - 25);
        if (exponent == 31) value = steps > 0 ? NAN : INFINITY;
        return bits >> 15 ? -value : value;
    }
};

}  // namespace tensormap
