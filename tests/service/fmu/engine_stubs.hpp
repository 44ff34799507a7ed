// As much of Gazebo's and ROS 2's headers as data/scenes/gz_joint.cpp and ros2_joint.cpp use.
#pragma once
#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace gz::math {
struct Vector3d {
    double v[3] = {0, 0, 0};
    Vector3d(double x = 0, double y = 0, double z = 0) : v{x, y, z} {}
    double &operator[](int k) { return v[k]; }
    double operator[](int k) const { return v[k]; }
    Vector3d operator+(const Vector3d &o) const { return {v[0] + o[0], v[1] + o[1], v[2] + o[2]}; }
    Vector3d operator*(double s) const { return {v[0] * s, v[1] * s, v[2] * s}; }
    Vector3d operator-(const Vector3d &o) const { return *this + o * -1.0; }
    Vector3d Cross(const Vector3d &o) const {
        return {v[1] * o[2] - v[2] * o[1], v[2] * o[0] - v[0] * o[2], v[0] * o[1] - v[1] * o[0]};
    }
};
struct Quaterniond {
    double w = 1;
    Vector3d u;
    double W() const { return w; }
    double X() const { return u[0]; }
    double Y() const { return u[1]; }
    double Z() const { return u[2]; }
    Quaterniond Inverse() const { return {w, u * -1.0}; }
    Vector3d RotateVector(const Vector3d &a) const { return a + u.Cross(u.Cross(a) + a * w) * 2.0; }
    Vector3d RotateVectorReverse(const Vector3d &a) const { return Inverse().RotateVector(a); }
    Quaterniond operator*(const Quaterniond &o) const {
        const double dot = u[0] * o.u[0] + u[1] * o.u[1] + u[2] * o.u[2];
        return {w * o.w - dot, o.u * w + u * o.w + u.Cross(o.u)};
    }
};
struct Pose3d {
    Vector3d p;
    Quaterniond q;
    const Vector3d &Pos() const { return p; }
    const Quaterniond &Rot() const { return q; }
    Pose3d operator*(const Pose3d &o) const { return {p + q.RotateVector(o.p), q * o.q}; }
};
struct Matrix3d {  // diagonal here
    Vector3d d;
    Matrix3d Inverse() const { return {{1 / d[0], 1 / d[1], 1 / d[2]}}; }
    Vector3d operator*(const Vector3d &a) const { return {d[0] * a[0], d[1] * a[1], d[2] * a[2]}; }
};
struct MassMatrix3d {
    double m;
    double Mass() const { return m; }
};
struct Inertiald {
    double m;
    Pose3d pose;
    const Pose3d &Pose() const { return pose; }
    MassMatrix3d MassMatrix() const { return {m}; }
};
}  // namespace gz::math

namespace sdf {
struct Element {
    template <class T> T Get(const std::string &name) const;
    template <class T> std::pair<T, bool> Get(const std::string &, const T &other) const {
        return {other, false};
    }
};
}  // namespace sdf

namespace gz::sim {
using Entity = unsigned long;
struct EntityComponentManager {};
struct EventManager {};
struct UpdateInfo {
    std::chrono::steady_clock::duration dt;
    bool paused = false;
};
struct System { virtual ~System() = default; };
struct ISystemConfigure {
    virtual void Configure(const Entity &, const std::shared_ptr<const sdf::Element> &,
                           EntityComponentManager &, EventManager &) = 0;
};
struct ISystemPreUpdate {
    virtual void PreUpdate(const UpdateInfo &, EntityComponentManager &) = 0;
};
struct State {
    math::Pose3d pose;
    math::Vector3d linear, angular, centre, inertia, force, torque;
    double mass;
};
inline State LINKS[3];  // by entity: none, base, tip
struct Link {
    State *s;
    using Ecm = EntityComponentManager;
    explicit Link(Entity entity = 0) : s(LINKS + entity) {}
    bool Valid(const Ecm &) const { return s != LINKS; }
    std::optional<math::Pose3d> WorldPose(const Ecm &) const { return s->pose; }
    std::optional<math::Vector3d> WorldAngularVelocity(const Ecm &) const { return s->angular; }
    std::optional<math::Vector3d> WorldLinearVelocity(const Ecm &, math::Vector3d at = {}) const {
        return s->linear + s->angular.Cross(s->pose.q.RotateVector(at));
    }
    std::optional<math::Inertiald> WorldInertial(const Ecm &) const {
        return math::Inertiald{s->mass, {s->centre, {}}};
    }
    std::optional<math::Matrix3d> WorldInertiaMatrix(const Ecm &) const { return math::Matrix3d{s->inertia}; }
    void EnableVelocityChecks(Ecm &) const {}
    void AddWorldWrench(Ecm &, math::Vector3d force, math::Vector3d torque) const {
        s->force = force, s->torque = torque;
    }
};
struct Model {
    explicit Model(Entity) {}
    Entity LinkByName(const EntityComponentManager &, const std::string &name) const {
        return name == "base" ? 1 : 2;
    }
};
}  // namespace gz::sim
#define GZ_ADD_PLUGIN(...)
#define RCLCPP_ERROR(...)

struct Vector { double x, y, z; };
struct Quaternion { double x, y, z, w; };
namespace geometry_msgs::msg {
struct WrenchStamped {
    int header;
    struct { Vector force, torque; } wrench;
};
}  // namespace geometry_msgs::msg
namespace nav_msgs::msg {
struct Odometry {
    int header;
    struct { struct { Vector position; Quaternion orientation; } pose; } pose;
    struct { struct { Vector linear, angular; } twist; } twist;
};
}  // namespace nav_msgs::msg
namespace rclcpp {
template <class T> struct Publisher {
    using SharedPtr = std::shared_ptr<Publisher>;
    void publish(const T &);
};
template <class T> struct Subscription { using SharedPtr = std::shared_ptr<Subscription>; };
struct Node {
    explicit Node(const std::string &) {}
    template <class T> T declare_parameter(const std::string &, const T &);
    template <class T> typename Publisher<T>::SharedPtr create_publisher(const std::string &, int);
    template <class T, class F>
    typename Subscription<T>::SharedPtr create_subscription(const std::string &, int, F &&) { return {}; }
    int get_logger() const;
};
void init(int, char **);
void spin(std::shared_ptr<Node>);
void shutdown();
}  // namespace rclcpp
