// Holds the headers to the conformance kit: check_vectors FOLDER, docs/reference/conformance.md.
// Prints what differs, and how many cases hold.
#include <cstdio>
#include <fstream>
#include <iostream>
#include <iterator>
#include <sstream>

#include "tensormap/tensormap.hpp"

namespace {

using tensormap::Json;

int differences = 0;

void require(bool same, const std::string& where) {
    if (same) return;
    std::cout << "differs: " << where << "\n";
    ++differences;
}

std::string read_file(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    if (!file) throw std::runtime_error(path + " cannot be read");
    return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

Json read_json(const std::string& path) {
    const std::string text = read_file(path);
    return tensormap::JsonReader(text).read();
}

std::vector<float> read_scan(const std::string& path) {
    const std::string body = read_file(path);
    std::vector<float> rows(body.size() / sizeof(float));
    std::memcpy(rows.data(), body.data(), rows.size() * sizeof(float));  // of a little-endian machine
    return rows;
}

std::string hex(const std::uint8_t* bytes, std::size_t count) {
    std::string digits;
    char two[3];
    for (std::size_t i = 0; i < count; ++i) {
        std::snprintf(two, sizeof two, "%02x", unsigned{bytes[i]});
        digits += two;
    }
    return digits;
}

std::vector<std::uint8_t> unhex(const std::string& digits) {
    std::vector<std::uint8_t> bytes;
    for (std::size_t at = 0; at < digits.size(); at += 2) {
        bytes.push_back(static_cast<std::uint8_t>(std::stoul(digits.substr(at, 2), nullptr, 16)));
    }
    return bytes;
}

template <typename Value>
std::string crc32(const std::vector<Value>& values) {
    const auto* bytes = reinterpret_cast<const std::uint8_t*>(values.data());
    std::uint32_t crc = 0xFFFFFFFF;
    for (std::size_t i = 0; i < values.size() * sizeof(Value); ++i) {
        crc ^= bytes[i];
        for (int bit = 0; bit < 8; ++bit) crc = crc & 1 ? crc >> 1 ^ 0xEDB88320 : crc >> 1;
    }
    char digits[9];
    std::snprintf(digits, sizeof digits, "%08x", ~crc);
    return digits;
}

// Signatures as they are in JSON.
std::vector<tensormap::Signature> signatures_of(const Json& items) {
    std::vector<tensormap::Signature> found;
    for (const Json& item : items.items) {
        const bool paper = !item["segment"].is_null();
        const Json& rows = item[paper ? "values" : "values_real"];
        tensormap::Signature signature{paper ? static_cast<int>(item["segment"].number) : -1,
                                       static_cast<int>(rows.items.size()),
                                       static_cast<int>(rows.items.at(0).items.size()),
                                       {}, {}, {}};
        for (const Json& row : rows.items) {
            for (double number : row.numbers()) signature.real.push_back(float(number));
        }
        for (const Json& row : item["values_imag"].items) {
            for (double number : row.numbers()) signature.imag.push_back(float(number));
        }
        for (double sector : item["hidden"].numbers()) signature.hidden.push_back(int(sector));
        signature.rings = static_cast<int>(item["rings"].number);
        found.push_back(signature);
    }
    return found;
}

void require_near(const std::vector<float>& found, const std::vector<float>& kept,
                  const std::string& where) {
    require(found.size() == kept.size(), where + " in size");
    const double largest = tensormap::packing::largest_of(kept);
    for (std::size_t i = 0; i < std::min(found.size(), kept.size()); ++i) {
        const double off = std::abs(double(found[i]) - double(kept[i]));
        require(off <= 1e-6 * std::abs(double(kept[i])) + 1e-9 * largest, where);
    }
}

void check_scan(const std::string& folder, const Json& item) {
    const std::string name = item["scan"].text + " with " + item["basis"].text + ": ";
    const auto basis = tensormap::Basis::of(read_json(folder + "/bases/" + item["basis"].text + ".json"));
    const double height_m = item["sensor_height_m"].number;
    const tensormap::Gravity known{item["roll_deg"].number, item["pitch_deg"].number};
    const tensormap::Gravity* gravity = item["roll_deg"].is_null() ? nullptr : &known;
    const bool refused = item["refused"].number != 0.0;
    const std::vector<float> rows = read_scan(folder + "/scans/" + item["scan"].text + ".bin");
    const std::size_t count = rows.size() / 4;
    tensormap::Image image{};
    try {
        image = tensormap::image_of_scan(rows.data(), count, 4, basis, height_m, gravity);
    } catch (const tensormap::Refused&) {
        require(refused, name + "refused");
        return;
    }
    require(!refused, name + "not refused");
    const auto plane = tensormap::plane_of_scan(rows.data(), count, 4, basis, height_m, gravity);
    require(plane.has_value() == !item["plane"].numbers().empty(), name + "plane");
    if (plane) {
        require(item["plane"].numbers() == std::vector<double>{plane->a, plane->b, plane->offset},
                name + "plane");
    }
    int returns = 0;
    std::vector<float> levelled;
    tensormap::each_block(rows.data(), count, 4, [&](tensormap::Returns& p) {
        returns += p.count;
        if (gravity) tensormap::level(p, *gravity);
        if (plane) tensormap::level(p, *plane, height_m, gravity != nullptr);
        for (int i = 0; i < p.count; ++i) levelled.insert(levelled.end(), {p.x[i], p.y[i], p.z[i]});
    });
    require(returns == item["returns"].number, name + "returns");
    require(crc32(levelled) == item["levelled_crc32"].text, name + "levelled returns");
    require(crc32(image.cells) == item["image_crc32"].text, name + "image");
    const std::vector<double> hidden(image.hidden.begin(), image.hidden.end());
    require(hidden == item["hidden"].numbers(), name + "hidden sectors");
    require(image.rings == item["rings"].number, name + "rings");
    const auto found = tensormap::signatures_of(image, basis);
    const auto kept = signatures_of(item["signatures"]);
    require(found.size() == kept.size(), name + "signatures");
    for (std::size_t i = 0; i < std::min(found.size(), kept.size()); ++i) {
        require(found[i].segment == kept[i].segment, name + "segment");
        require_near(found[i].real, kept[i].real, name + "values");
        require_near(found[i].imag, kept[i].imag, name + "imaginary values");
    }
    for (const auto& field : item["packed"].fields) {
        std::string digits;
        try {
            const auto body = tensormap::packed(found, basis.digest, field.first == "float16");
            digits = hex(body.data(), body.size());
        } catch (const std::runtime_error&) {
        }  // beyond float16: null
        require(digits == field.second.text, name + field.first);
    }
}

void check_plane(const Json& item) {
    tensormap::Returns p;
    for (const Json& row : item["returns_m"].items) {
        const std::vector<double> at = row.numbers();
        p.x[p.count] = float(at.at(0)), p.y[p.count] = float(at.at(1)), p.z[p.count] = float(at.at(2));
        ++p.count;
    }
    tensormap::ground::LowestReturns lowest;
    lowest.add(p);
    const auto plane = tensormap::ground_plane(lowest.cells(), item["sensor_height_m"].number);
    const auto found = plane ? std::vector<double>{plane->a, plane->b, plane->offset}
                             : std::vector<double>{};
    require(found == item["plane"].numbers(), "plane");
}

void check_packing(const Json& item) {
    const auto body = tensormap::packed(signatures_of(item["signatures"]), item["basis"].text,
                                        item["packing"].text == "float16");
    require(hex(body.data(), body.size()) == item["packed"].text, item["name"].text);
}

void check_answer(const Json& item) {
    static const char* const reasons[] = {"",                "unknown_place", "ambiguous",
                                          "too_few_returns", "outside_prior", "not_calibrated"};
    const auto body = unhex(item["packed"].text);
    require(body.size() == tensormap::Answer::bytes, item["name"].text + " in size");
    const auto found = tensormap::Answer::of(body.data(), body.size());
    const Json& kept = item["decoded"];
    require(found.localized == (kept["localized"].number != 0.0), item["name"].text + ": localized");
    require(found.of_live == (kept["of_live"].number != 0.0), item["name"].text + ": of_live");
    require(found.estimated == (kept["estimated"].number != 0.0), item["name"].text + ": estimated");
    require(reasons[static_cast<int>(found.reason)] == kept["reason"].text,
            item["name"].text + ": reason");
    require(hex(found.revision.data(), 8) == kept["revision"].text, item["name"].text + ": revision");
    const std::pair<const char*, double> numbers[] = {
        {"segment", found.segment},         {"drive", found.drive},
        {"scan_index", found.scan_index},   {"probability", found.probability},
        {"distance", found.distance},       {"ratio", found.ratio},
        {"z_m", found.z_m},                 {"yaw_deg", found.yaw_deg},
        {"along_std_m", found.along_std_m}, {"lateral_std_m", found.lateral_std_m},
        {"x_m", found.x_m},                 {"heading_std_deg", found.heading_std_deg},
        {"y_m", found.y_m}};
    for (const auto& [name, number] : numbers) {
        const bool same = kept[name].is_null() ? std::isnan(number) : number == kept[name].number;
        require(same, item["name"].text + ": " + name);
    }
}

}  // namespace

int main(int count, char** words) try {
    if (count != 2) {
        std::cerr << "usage: check_vectors FOLDER\n";
        return 2;
    }
    const std::string folder = words[1];
    int checked = 0, failed = 0;
    for (const auto& [name, check] :
         {std::pair<const char*, void (*)(const std::string&, const Json&)>{"signatures", check_scan},
          {"planes", [](const std::string&, const Json& item) { check_plane(item); }},
          {"packing", [](const std::string&, const Json& item) { check_packing(item); }},
          {"answers", [](const std::string&, const Json& item) { check_answer(item); }}}) {
        for (const Json& item : read_json(folder + "/" + name + ".json").items) {
            const int before = differences;
            check(folder, item);
            ++checked;
            failed += differences > before ? 1 : 0;
        }
    }
    std::cout << checked - failed << " of " << checked << " cases hold\n";
    return failed > 0 || checked == 0 ? 1 : 0;
} catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
    return 1;
}
