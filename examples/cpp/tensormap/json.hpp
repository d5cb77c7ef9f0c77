// Reads JSON: a basis as the service answers it, and the conformance kit.
#pragma once

#include <cstdlib>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace tensormap {

struct Json {
    enum class Kind { null, boolean, number, text, list, object };

    Kind kind = Kind::null;
    double number = 0.0;  // of a boolean 0 or 1
    std::string text;
    std::vector<Json> items;
    std::vector<std::pair<std::string, Json>> fields;

    bool is_null() const { return kind == Kind::null; }

    // The field of that name, null if there is none.
    const Json& operator[](const std::string& name) const {
        static const Json nothing;
        for (const auto& field : fields) {
            if (field.first == name) return field.second;
        }
        return nothing;
    }

    std::vector<double> numbers() const {
        std::vector<double> found;
        for (const Json& item : items) found.push_back(item.number);
        return found;
    }
};

class JsonReader {
   public:
    explicit JsonReader(const std::string& text) : text_(text) {}

    Json read() {
        Json value = read_value(0);
        if (next() != '\0' || at_ < text_.size()) fail();
        return value;
    }

   private:
    static constexpr int deepest = 64;

    Json read_value(int depth) {
        if (depth > deepest) fail();
        Json value;
        const char first = next();
        if (first == '{' || first == '[') {
            const bool named = first == '{';
            const char last = named ? '}' : ']';
            value.kind = named ? Json::Kind::object : Json::Kind::list;
            ++at_;
            while (next() != last) {
                if (!value.items.empty() || !value.fields.empty()) take(',');
                if (named) {
                    std::string name = read_text();
                    take(':');
                    value.fields.emplace_back(std::move(name), read_value(depth + 1));
                } else {
                    value.items.push_back(read_value(depth + 1));
                }
            }
            ++at_;
        } else if (first == '"') {
            value.kind = Json::Kind::text;
            value.text = read_text();
        } else if (!took("null")) {
            value.kind = Json::Kind::boolean;
            if (took("true")) {
                value.number = 1.0;
            } else if (!took("false")) {
                value.kind = Json::Kind::number;
                char* end = nullptr;  // in the "C" locale, in which a program begins
                value.number = std::strtod(text_.c_str() + at_, &end);
                if (end == text_.c_str() + at_) fail();
                at_ = static_cast<std::size_t>(end - text_.c_str());
            }
        }
        return value;
    }

    // Escapes other than of one character are kept as they are: no name of the service has one.
    std::string read_text() {
        take('"');
        std::string found;
        while (at_ < text_.size() && text_[at_] != '"') {
            if (text_[at_] == '\\' && text_[at_ + 1] != 'u') ++at_;
            found += text_[at_++];
        }
        take('"');
        return found;
    }

    char next() {
        while (at_ < text_.size() && std::string(" \t\r\n").find(text_[at_]) != std::string::npos) {
            ++at_;
        }
        return at_ < text_.size() ? text_[at_] : '\0';
    }

    bool took(const std::string& word) {
        if (text_.compare(at_, word.size(), word) != 0) return false;
        at_ += word.size();
        return true;
    }

    void take(char wanted) {
        if (next() != wanted) fail();
        ++at_;
    }

    [[noreturn]] void fail() const {
        throw std::runtime_error("the text is not JSON at byte " + std::to_string(at_));
    }

    const std::string& text_;
    std::size_t at_ = 0;
};

}  // namespace tensormap
