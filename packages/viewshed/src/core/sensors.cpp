#include "sensors.hpp"

#include <cctype>
#include <numbers>

namespace viewshed {
namespace {

struct Row {
    const char *key, *name;
    int columns;
    double min_range_m, max_range_m;
    std::optional<double> reach_m;
    bool fires_rings, is_inferred;
    std::vector<double> elevations_deg, origins_m;
};

const std::vector<Row>& rows() {
    static const std::vector<Row> table = {
#include "beam_tables.inc"
    };
    return table;
}

SensorModel model_of(const Row& row) {
    std::vector<double> elevation = row.elevations_deg, origin_m = row.origins_m;
    for (double& angle : elevation) angle *= std::numbers::pi / 180.0;
    origin_m.resize(elevation.size(), 0.0);
    return {row.key,         row.name,    BeamTable(std::move(elevation), std::move(origin_m), row.columns),
            row.min_range_m, row.max_range_m, row.reach_m, row.fires_rings, row.is_inferred};
}

std::string normalized(const std::string& name) {
    std::string letters;
    for (const unsigned char c : name) {
        if (std::isalnum(c)) letters += char(std::tolower(c));
    }
    return letters;
}

}  // namespace

const std::vector<SensorModel>& shipped_sensors() {
    static const std::vector<SensorModel> sensors = [] {
        std::vector<SensorModel> all;
        for (const Row& row : rows()) all.push_back(model_of(row));
        return all;
    }();
    return sensors;
}

const SensorModel* find_sensor(const std::string& name) {
    const std::string key = normalized(name);
    for (const SensorModel& sensor : shipped_sensors()) {
        if (normalized(sensor.key) == key) return &sensor;
    }
    return nullptr;
}

}  // namespace viewshed
