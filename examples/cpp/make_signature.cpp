// The body of a query, of a basis as JSON and a scan in KITTI's format:
// make_signature BASIS.json SCAN.bin [SENSOR_HEIGHT_M] > BODY
#include <cstring>
#include <fstream>
#include <iostream>
#include <iterator>

#include "tensormap/tensormap.hpp"

namespace {

std::string read_file(const char* path) {
    std::ifstream file(path, std::ios::binary);
    if (!file) throw std::runtime_error(std::string(path) + " cannot be read");
    return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

}  // namespace

int main(int count, char** words) try {
    if (count < 3 || count > 4) {
        std::cerr << "usage: make_signature BASIS.json SCAN.bin [SENSOR_HEIGHT_M]\n";
        return 2;
    }
    const std::string json = read_file(words[1]), scan = read_file(words[2]);
    const auto basis = tensormap::Basis::of(tensormap::JsonReader(json).read());
    const double height_m = count == 4 ? std::stod(words[3]) : basis.sensor_height_m;
    if (scan.size() % 16 != 0) {
        throw std::runtime_error(std::string(words[2]) + " has " + std::to_string(scan.size()) +
                                 " bytes, wanted 16 a return");
    }
    std::vector<float> rows(scan.size() / sizeof(float));  // of a little-endian machine
    if (!rows.empty()) std::memcpy(rows.data(), scan.data(), scan.size());
    const auto body = tensormap::query(rows.data(), rows.size() / 4, 4, basis, height_m);
    std::cout.write(reinterpret_cast<const char*>(body.data()),
                    static_cast<std::streamsize>(body.size()));
    return 0;
} catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
    return 1;
}
